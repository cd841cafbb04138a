"""Signed commands against arbitrary changes: any text comes back as it was, and no changed byte passes."""

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from controllers.commands.command_signature import Signer, Verifier
from models.errors import CommandError

KEY = b"k" * 32
NOW = 1_790_000_000_000_000_000
texts = st.text(min_size=1, max_size=60).filter(lambda text: text.isprintable() and bool(text.strip()))


def verifier() -> Verifier:
    times = iter([NOW - 10_000_000_000])  # it began to listen 10 s ago
    return Verifier(KEY, 1.0, lambda: next(times, NOW))


@settings(deadline=None)
@given(texts, st.from_regex(r"[a-z0-9_-]{1,32}", fullmatch=True))
def test_a_command_comes_back(text: str, source: str) -> None:
    command = verifier().verify(Signer(KEY, source, lambda: NOW).sign(text))
    assert (command.text, command.source) == (text, source)


@settings(deadline=None)
@given(texts, st.data())
def test_no_changed_byte_passes(text: str, data: st.DataObject) -> None:
    line = Signer(KEY, "teleop", lambda: NOW).sign(text).encode()
    place = data.draw(st.integers(0, len(line) - 1))
    changed = bytearray(line)
    changed[place] ^= data.draw(st.integers(1, 255))
    with pytest.raises(CommandError):
        verifier().verify(changed.decode("utf-8", "surrogateescape"))


@settings(deadline=None)
@given(texts, st.data())
def test_nothing_added_or_cut_passes(text: str, data: st.DataObject) -> None:
    line = Signer(KEY, "teleop", lambda: NOW).sign(text)
    start = data.draw(st.integers(0, len(line)))
    end = data.draw(st.integers(start, len(line)))
    other = line[:start] + data.draw(st.text(max_size=5)) + line[end:]
    assume(other != line)
    with pytest.raises(CommandError):
        verifier().verify(other)
