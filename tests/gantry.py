"""A quick start for tests of what follows it; the start as it is has its own tests."""

from dataclasses import replace
from typing import Any, TypeVar

from bridge.hardware_loop import PlantLoop

LoopT = TypeVar("LoopT", bound=PlantLoop[Any, Any, Any, Any])


def started(loop: LoopT) -> LoopT:
    """The robot stands without the rope, after shorter waits, a faster ramp and a faster crane than the usual ones."""
    startup, side = loop.startup, loop.side
    startup.config = replace(startup.config, listen_time=0.2, settle_time=0.2, ramp_time=1.0, ramp_speed=3.0)
    side.config = replace(side.config, lowering_speed=0.15)
    loop.start()
    loop.unhook()
    return loop
