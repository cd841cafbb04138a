"""Who is in command: priorities, timeouts, locks, and the velocities that words set."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.commands.arbitration import (
    NO_SOURCE,
    Arbiter,
    ArbitrationConfig,
    LockConfig,
    SourceConfig,
)
from models.config import default_config, parse_config
from models.errors import CommandError, ConfigError
from models.types import STILL, Velocity

AHEAD, LEFT, TURN = (0.3, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.5)


@pytest.fixture
def arbiter() -> Arbiter:
    return Arbiter()


def test_no_source_is_in_command_before_the_first_message(arbiter: Arbiter) -> None:
    assert (arbiter.in_command(0.0), arbiter.velocity(0.0)) == (NO_SOURCE, STILL)


def test_the_higher_source_counts_until_it_falls_silent(arbiter: Arbiter) -> None:
    arbiter.repeat("autonomy", AHEAD, 0.0)
    assert (arbiter.in_command(0.1), arbiter.velocity(0.1)) == ("autonomy", AHEAD)
    arbiter.repeat("teleop", LEFT, 0.2)
    arbiter.repeat("autonomy", AHEAD, 0.6)
    assert (arbiter.in_command(0.7), arbiter.velocity(0.7)) == ("teleop", LEFT)
    assert (arbiter.in_command(0.71), arbiter.velocity(0.71)) == ("autonomy", AHEAD)
    assert (arbiter.in_command(1.11), arbiter.velocity(1.11)) == (NO_SOURCE, STILL)


def test_words_of_lower_sources_are_refused_and_name_who_is_in_command(arbiter: Arbiter) -> None:
    arbiter.executed("teleop", 1.0)
    with pytest.raises(CommandError, match="'autonomy' is not in command: 'teleop' is"):
        arbiter.require("autonomy", 1.5)
    arbiter.require("safety", 1.5)
    arbiter.require("teleop", 1.5)
    arbiter.require("autonomy", 1.51)


def test_the_velocity_of_a_word_holds_until_an_equal_says_something_else(arbiter: Arbiter) -> None:
    arbiter.repeat("autonomy", TURN, 0.0)
    arbiter.hold("plain", AHEAD)
    assert (arbiter.in_command(100.0), arbiter.velocity(100.0)) == ("plain", AHEAD)
    arbiter.repeat("autonomy", TURN, 100.0)
    assert arbiter.velocity(100.1) == AHEAD
    arbiter.repeat("teleop", LEFT, 100.0)
    assert arbiter.velocity(100.1) == LEFT
    assert arbiter.velocity(100.6) == STILL  # the higher one has let go; what it overruled does not come back
    arbiter.hold("plain", AHEAD)
    arbiter.repeat("plain", TURN, 101.0)
    assert arbiter.velocity(101.0) == TURN
    assert arbiter.velocity(102.0) == STILL  # silence does not bring the word back
    arbiter.hold("teleop", AHEAD)
    arbiter.forget()
    assert arbiter.in_command(102.0) == NO_SOURCE


def test_a_word_keeps_its_source_in_command_but_brings_no_old_velocity_back(arbiter: Arbiter) -> None:
    arbiter.repeat("teleop", AHEAD, 0.0)
    arbiter.hold("teleop", LEFT)
    arbiter.executed("teleop", 1.0)
    assert arbiter.velocity(50.0) == LEFT
    arbiter.forget()
    arbiter.executed("teleop", 60.0)
    assert (arbiter.in_command(60.5), arbiter.velocity(60.5)) == ("teleop", STILL)


def test_a_lock_silences_what_is_below_it(arbiter: Arbiter) -> None:
    arbiter.repeat("teleop", AHEAD, 0.0)
    arbiter.repeat("safety", STILL, 0.0)
    arbiter.lock("pause", True, 0.1)
    assert arbiter.in_command(0.2) == "safety"
    for act in (lambda: arbiter.repeat("teleop", AHEAD, 0.3), lambda: arbiter.require("teleop", 0.3)):
        with pytest.raises(CommandError, match="'teleop' is locked out by 'pause'"):
            act()
    assert (arbiter.in_command(0.51), arbiter.locks(0.51)) == (NO_SOURCE, ("pause",))
    arbiter.lock("pause", False, 0.6)
    arbiter.repeat("teleop", AHEAD, 0.6)
    assert arbiter.velocity(0.7) == AHEAD
    with pytest.raises(CommandError, match="unknown lock 'door'; known: pause"):
        arbiter.lock("door", True, 0.0)


def test_a_lock_that_must_be_kept_open_closes_in_silence_and_when_the_clock_goes_back() -> None:
    config = replace(default_config(ArbitrationConfig, "controllers", "arbitration"))
    arbiter = Arbiter(replace(config, locks={"dead_man": LockConfig(priority=150, timeout=0.2)}))
    with pytest.raises(CommandError, match="locked out by 'dead_man'"):
        arbiter.repeat("teleop", AHEAD, 0.0)
    arbiter.lock("dead_man", False, 1.0)
    arbiter.repeat("teleop", AHEAD, 1.0)
    assert arbiter.velocity(1.2) == AHEAD
    assert arbiter.velocity(1.21) == STILL
    arbiter.lock("dead_man", False, 1.3)
    arbiter.executed("teleop", 1.3)
    arbiter.restart()
    assert (arbiter.locks(0.1), arbiter.in_command(0.1)) == (("dead_man",), NO_SOURCE)


@pytest.mark.parametrize("bad", [(math.nan, 0.0, 0.0), (0.0, math.inf, 0.0)])
def test_velocities_that_are_no_numbers_are_refused(arbiter: Arbiter, bad: Velocity) -> None:
    with pytest.raises(CommandError, match="of 'plain' is not finite"):
        arbiter.repeat("plain", bad, 0.0)
    with pytest.raises(CommandError, match="unknown source 'ghost'; known: safety, teleop, plain, autonomy"):
        arbiter.repeat("ghost", AHEAD, 0.0)
    assert arbiter.in_command(0.0) == NO_SOURCE


@pytest.mark.parametrize(
    ("sources", "culprit"),
    [
        ({"teleop": {"priority": 1, "timeout": 0.5}}, "'plain' is missing"),
        ({"plain": {"priority": 1, "timeout": 0.5}, "b": {"priority": 1, "timeout": 0.5}}, "the same priority"),
        ({"plain": {"priority": 1, "timeout": 0.0}}, "timeout"),
        ({"plain": {"priority": 1, "timeout": 0.5}, "Tele-op": {"priority": 2, "timeout": 0.5}}, "'Tele-op'"),
    ],
)
def test_unusable_configurations_are_refused_by_name(sources: dict[str, object], culprit: str) -> None:
    with pytest.raises(ConfigError, match=culprit):
        parse_config(ArbitrationConfig, {"sources": sources, "locks": {}}, "arbitration.yaml")


EVENTS = st.lists(
    st.tuples(
        st.sampled_from(["repeat", "spoke", "hold", "lock", "open", "wait"]),
        st.sampled_from(["safety", "teleop", "plain", "autonomy"]),
        st.floats(0.0, 0.4),
    ),
    max_size=40,
)


@given(EVENTS)
def test_no_source_above_the_one_in_command_is_fresh_and_open(events: list[tuple[str, str, float]]) -> None:
    """Against a plain list of who has spoken when."""
    config = ArbitrationConfig(
        {name: SourceConfig(p, 0.5) for name, p in (("safety", 3), ("teleop", 2), ("plain", 1), ("autonomy", 0))},
        {"pause": LockConfig(2, 0.0)},
    )
    arbiter, until, locked, t = Arbiter(config), dict.fromkeys(config.sources, -1.0), False, 0.0
    for kind, source, wait in events:
        t += wait
        closed = locked and config.sources[source].priority < 2
        if kind == "repeat" and not closed:
            arbiter.repeat(source, AHEAD, t)
            for name, of in config.sources.items():
                if of.priority < config.sources[source].priority and until[name] == math.inf:
                    until[name] = -1.0
            until[source] = t + 0.5
        elif kind == "spoke" and not closed:
            arbiter.executed(source, t)
            until[source] = max(until[source], t + 0.5)
        elif kind == "hold" and not closed:
            arbiter.hold(source, LEFT)
            for name, of in config.sources.items():
                if of.priority < config.sources[source].priority:
                    until[name] = -1.0
            until[source] = math.inf
        elif kind in ("lock", "open"):
            locked = kind == "lock"
            arbiter.lock("pause", locked, t)
        open_ones = [n for n in until if until[n] >= t and not (locked and config.sources[n].priority < 2)]
        expected = max(open_ones, key=lambda n: config.sources[n].priority, default=NO_SOURCE)
        assert arbiter.in_command(t) == expected
