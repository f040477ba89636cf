"""``sidelong sign``: a key for signed links, made here and given to a vehicle."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from sidelong.app.commands.output import console, say
from sidelong.app.errors import InputError
from sidelong.app.link.key_file import key_in_use, make_key, read_key
from sidelong.app.link.key_setup import KeySetup, checked_local_url
from sidelong.app.link.signing import signing_time


def sign(
    key: Annotated[Path, typer.Argument(help="The key's file; made if it is not there.")],
    connect: Annotated[str | None, typer.Option(help="URL of the vehicle that is to have it, by cable.")] = None,
    remove: Annotated[bool, typer.Option("--remove", help="Take the key back from the vehicle.")] = False,
    timeout: Annotated[float, typer.Option(min=1.0, help="Wait this long for a heartbeat, s.")] = 10.0,
) -> None:
    """Make a key for MAVLink signing and set it up on a vehicle. The vehicle then accepts only signed messages.

    Disarm the vehicle and connect it by cable: the key is sent unencrypted. Then fly with
    --set link.signing_key_file=FILE.

    For example:
      sidelong sign plane.key
      sidelong sign plane.key --connect serial:///dev/ttyACM0:115200
      sidelong sign plane.key --connect serial:///dev/ttyACM0:115200 --remove
    """
    if remove and connect is None:
        raise InputError("--remove needs the vehicle: give --connect URL.")
    if connect is not None:
        checked_local_url(connect)
    if key.exists():
        read_key(key)
    elif remove:
        raise InputError(f"{key} is not there; --remove needs the key that the vehicle has.")
    else:
        make_key(key)
        say(f"made {key}: copy it only to machines that may command the vehicle")
    if connect is None:
        return
    with (
        key_in_use(key, signing_time(time.time()), console.print) as used,
        KeySetup(connect, used) as setup,
    ):
        say(f"waiting for a heartbeat on {connect}")
        if remove:
            setup.take_back(timeout)
            console.print("the vehicle no longer signs and accepts commands from any sender")
        elif setup.give(timeout):
            console.print("the vehicle signs, and refuses frames that are not signed with the key")
        else:
            say("the vehicle signs; on this very port it still takes what is unsigned (ArduPlane does so on USB)")
