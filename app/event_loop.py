"""An event loop that ends when its work is done, whatever still blocks a thread; see :mod:`sidelong.app.shutdown`."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

T = TypeVar("T")


class _Threads(ThreadPoolExecutor):
    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        super().shutdown(wait=False, cancel_futures=True)


def run(main: Coroutine[Any, Any, T]) -> T:
    """Do as ``asyncio.run``, without waiting for calls that still block a thread when ``main`` is done."""

    async def with_threads() -> T:
        asyncio.get_running_loop().set_default_executor(_Threads())
        return await main

    return asyncio.run(with_threads())
