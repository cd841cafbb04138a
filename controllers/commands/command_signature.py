"""Signed text commands: protection against forgery, changes and replay.

    v1 <source> <stamp> <tag> <text>        tag = HMAC-SHA256(key, "v1 <source> <stamp> <text>") in hexadecimal

The stamp is the sender's wall time in nanoseconds, increased to at least one more than the previous stamp. A command is
accepted if its tag is correct, its stamp is newer than the last one accepted from the same source, and the stamp is
within a window of the verifier's wall time. Replayed, overtaken and delayed commands are therefore refused. Unlike a
counter, the stamp needs no file when a sender restarts. The window bounds the delay of a command and the difference of
the two clocks.

A restarted verifier has lost the stamps. It refuses, with that reason, all commands stamped before its start plus one
window. No command accepted earlier has a later stamp, so no replay passes.

Limits:
    - If the sender's clock is set back, its commands are refused with that reason until the clock has caught up. If the
      verifier's clock is set back and the verifier restarts, it accepts replays of commands since that time of day:
      make a new key.
    - Every holder of the key can sign for any source. Nothing is encrypted.
    - A suppressed command is not detected.

A key file contains random bytes in hexadecimal, readable only by their owner.
"""

import hashlib
import hmac
import os
import re
import secrets
import stat
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from models.constants import NANOSECONDS
from models.errors import CommandError, ConfigError

VERSION = "v1"

KEY_BYTES = 32  #: Minimum length of a key [bytes]
MAX_TEXT = 256  #: Longest text that is signed [characters]; the supervisor accepts no longer text
_MAX_KEY_FILE = 4096  #: Longest key file that is read [bytes]
_MAX_LINE = 512  #: Longest line that is parsed [characters]
_SOURCE = re.compile(r"[a-z0-9_-]{1,32}", re.ASCII)
_STAMP = re.compile(r"[1-9][0-9]{0,18}", re.ASCII)


@dataclass(frozen=True, slots=True)
class VerifiedCommand:
    """A command with a valid signature."""

    source: str
    text: str


def _tag(key: bytes, source: str, stamp: str, text: str) -> str:
    """Tag of a command; the signed bytes are unambiguous, because neither source nor stamp contains a blank."""
    signed = f"{VERSION} {source} {stamp} {text}".encode("utf-8", "surrogatepass")
    return hmac.new(key, signed, hashlib.sha256).hexdigest()


def _checked_key(key: bytes) -> bytes:
    if len(key) < KEY_BYTES:
        raise ConfigError(f"key: {len(key)} bytes are fewer than {KEY_BYTES}")
    return bytes(key)


class Signer:
    """Signs the commands of one source.

    ``clock`` returns the wall time [ns]; ``source`` has 1 to 32 characters of a-z, 0-9, ``_`` and ``-``. Raises
    ``ConfigError`` otherwise, or for a ``key`` shorter than ``KEY_BYTES``.
    """

    def __init__(self, key: bytes, source: str, clock: Callable[[], int] = time.time_ns) -> None:
        if not _SOURCE.fullmatch(source):
            raise ConfigError(f"source: '{source[:40]}' is not 1 to 32 of a-z, 0-9, '_' and '-'")
        self._key, self._source, self._clock = _checked_key(key), source, clock
        self._last = 0

    def sign(self, text: str) -> str:
        """Signed line of a command; ``CommandError`` if the text is empty, too long, or not one printable line."""
        if not text.strip() or len(text) > MAX_TEXT or not text.isprintable():
            raise CommandError(f"cannot be signed: {text[:32]!r} is not one line of 1 to {MAX_TEXT} characters")
        self._last = max(self._clock(), self._last + 1)
        return f"{VERSION} {self._source} {self._last} {_tag(self._key, self._source, str(self._last), text)} {text}"


class Verifier:
    """Verifies signed commands; a refused command does not change the state.

    ``window`` is the largest difference between a stamp and the wall time ``clock`` [ns], of either sign [s]. Raises
    ``ConfigError`` if it is not positive and finite, or the key is too short.
    """

    def __init__(self, key: bytes, window: float, clock: Callable[[], int] = time.time_ns) -> None:
        if not 0.0 < window < float("inf"):
            raise ConfigError(f"window: {window} s is not a positive time")
        self._key, self._clock = _checked_key(key), clock
        self._window = round(window * NANOSECONDS)
        self._first = clock() + self._window
        self._newest: dict[str, int] = {}

    def verify(self, line: str) -> VerifiedCommand:
        """Verify a line of ``Signer.sign``; ``CommandError`` if unsigned, forged, replayed, too old or too early."""
        source, stamp, tag, text = self._parts(line)
        if not hmac.compare_digest(tag.encode("utf-8", "replace"), _tag(self._key, source, stamp, text).encode()):
            raise CommandError(f"forged: the signature of '{source[:32]}' is wrong; signed with another key or changed")
        self._check_stamp(source, int(stamp))
        self._newest[source] = int(stamp)
        return VerifiedCommand(source, text)

    def _parts(self, line: str) -> tuple[str, str, str, str]:
        if len(line) > _MAX_LINE:
            raise CommandError(f"{len(line)} characters are too long for a signed command")
        version, *rest = line.split(" ", 4)
        if len(rest) != 4:
            raise CommandError("unsigned: sign it (poise send --key FILE TEXT)")
        if version != VERSION:
            unknown = re.fullmatch(r"v[0-9]+", version, re.ASCII) is not None
            raise CommandError(
                f"version '{version[:8]}' of the signature is unknown; this is {VERSION}"
                if unknown
                else "unsigned: sign it (poise send --key FILE TEXT)"
            )
        source, stamp, tag, text = rest
        if not _SOURCE.fullmatch(source) or not _STAMP.fullmatch(stamp):
            raise CommandError("forged: source or stamp is malformed")
        return source, stamp, tag, text

    def _check_stamp(self, source: str, stamp: int) -> None:
        """Refuse a stamp outside the accepted range; the cause is a replay or a change of a clock."""
        now, newest = self._clock(), self._newest.get(source)
        if newest is not None and stamp <= newest:
            behind = (newest - stamp) / NANOSECONDS
            raise CommandError(
                f"replayed: '{source}' has sent a newer command, stamped {behind:.3f} s later"
                + (
                    f"; or the sender's clock was set back: wait {behind:.0f} s"
                    if stamp + self._window < newest
                    else ""
                )
            )
        age = (now - stamp) / NANOSECONDS
        if now - stamp > self._window:
            raise CommandError(f"too old: stamped {age:.3f} s ago; delayed, replayed, or the clocks differ")
        if stamp - now > self._window:
            raise CommandError(f"stamped {-age:.3f} s ahead: the clocks of sender and robot differ")
        if stamp <= self._first:
            wait = self._first - stamp
            why = "the robot has just started" if wait <= 2 * self._window else "the robot's clock was set back"
            raise CommandError(f"{why}, so this may be a replay: send it again in {wait / NANOSECONDS:.1f} s")


def write_key(path: Path) -> None:
    """Create a key file of ``KEY_BYTES`` random bytes with mode 0600; ``ConfigError`` if it exists already."""
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "w", encoding="ascii") as file:
            file.write(f"{secrets.token_hex(KEY_BYTES)}\n")
    except FileExistsError as error:
        raise ConfigError(
            f"{path}: exists already, and a key is not overwritten: its holders could no longer send"
        ) from error
    except OSError as error:
        raise ConfigError(f"{path}: no key can be written: {error.strerror}") from error


def read_key(path: Path) -> bytes:
    """Read a key file; ``ConfigError`` when it is absent, readable by others, or too short."""
    try:
        with path.open("rb") as file:
            mode = os.fstat(file.fileno()).st_mode  # of the opened file, not of the path
            text = file.read(_MAX_KEY_FILE)
    except OSError as error:
        raise ConfigError(f"{path}: no key can be read: {error.strerror}; make one with: poise key {path}") from error
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise ConfigError(f"{path}: others may read or write this key; make it private with: chmod 600 {path}")
    try:
        key = bytes.fromhex(text.decode("ascii").strip())
    except ValueError as error:
        raise ConfigError(f"{path}: not a key in hexadecimal") from error  # the message omits the content
    if len(key) < KEY_BYTES:
        raise ConfigError(f"{path}: {len(key)} bytes are fewer than {KEY_BYTES}")
    return key
