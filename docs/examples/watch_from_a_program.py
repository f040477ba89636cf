"""Watch for some time inside an asyncio program, and print where the target is.

python watch_from_a_program.py [URL]    # without URL a vehicle and its target are simulated
"""

import asyncio
import sys

import sidelong

REPORTS, EVERY_S = 5, 2.0


async def main(url: str | None) -> None:
    """Watch until some positions are printed."""
    config = {"requirement": {"side": "left"}, "simulation": {"target": "walk"}}
    reports, next_s = 0, 0.0
    async with sidelong.watch(config, url=url, note=print) as watch:
        async for state in watch.snapshots():
            target = state.estimate
            if state.phase != "watching" or target is None or state.time_s < next_s:
                continue
            next_s, reports = state.time_s + EVERY_S, reports + 1
            east_m, north_m = target.position_m(state.time_s)
            latitude_deg, longitude_deg = watch.plane.latitude_longitude_deg(east_m, north_m)
            print(f"target at {latitude_deg:.6f}, {longitude_deg:.6f}, {target.speed_m_s:.1f} m/s")
            if reports == REPORTS:
                watch.end()
    print(f"outcome: {watch.summary.outcome}")


asyncio.run(main(sys.argv[1] if len(sys.argv) > 1 else None))
