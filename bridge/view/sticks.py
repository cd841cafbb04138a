"""Velocity sticks of the page, which are let go when nobody holds them any more."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from typing import Any

from models.nodes.velocity import Velocity
from planners.gait.config import VelocityConfig

STICK_STEP = 0.05
"""Of the velocity sticks [m/s], [rad/s]."""


class DeadMan:
    """Knows whether the one who steers is still there: his browser is connected, and he has moved something lately.

    Args:
        idle: So long after the last touch he counts as gone [s].
    """

    def __init__(self, idle: float) -> None:
        self._idle = idle
        self._who: int | None = None
        self._when = 0.0

    def touch(self, who: int, now: float) -> None:
        """A browser has moved a stick at a time [s]."""
        self._who, self._when = who, now

    def there(self, browsers: Collection[int], now: float) -> bool:
        """Whether he is there.

        Args:
            browsers: Those that are connected.
            now: Time [s].
        """
        return self._who in browsers and now - self._when <= self._idle


class Sticks:
    """Three sliders and a box that has their velocity published.

    Args:
        gui: viser's gui.
        limits: Ends of the sliders.
        idle: Without a touch for so long they are let go [s].
        tell: Called when they are let go.
    """

    def __init__(self, gui: Any, limits: VelocityConfig, idle: float, tell: Callable[[str], object]) -> None:
        self._dead_man, self._tell, self._idle = DeadMan(idle), tell, idle
        ends = {
            "forward [m/s]": (-limits.backward, limits.forward),
            "left [m/s]": (-limits.lateral, limits.lateral),
            "turn [rad/s]": (-limits.turn, limits.turn),
        }
        with gui.add_folder("velocity, in mode walk"):
            hint = f"Publish the sticks' velocity, for {idle:g} s after the last touch."
            self._drive = gui.add_checkbox("drive", initial_value=False, hint=hint)
            self._sliders = [
                gui.add_slider(label, round(low, 2), round(high, 2), STICK_STEP, 0.0)
                for label, (low, high) in ends.items()
            ]
            gui.add_button("sticks to zero").on_click(lambda _: self._zero())
        for handle in (self._drive, *self._sliders):
            handle.on_update(self._on_touch)

    def velocity(self, browsers: Collection[int]) -> Velocity | None:
        """Forward [m/s], left [m/s], turn [rad/s]; None while nobody steers.

        Args:
            browsers: Those that are connected.
        """
        if not self._drive.value:
            return None
        if not self._dead_man.there(browsers, time.monotonic()):
            self._drive.value = False
            self._zero()
            self._tell(f"sticks let go: nobody has moved them for {self._idle:g} s, or his browser is gone")
            return None
        forward, left, turn = (float(slider.value) for slider in self._sliders)
        return forward, left, turn

    def _on_touch(self, event: Any) -> None:
        if event.client_id is not None:  # a browser's, not ours
            self._dead_man.touch(event.client_id, time.monotonic())

    def _zero(self) -> None:
        for slider in self._sliders:
            slider.value = 0.0
