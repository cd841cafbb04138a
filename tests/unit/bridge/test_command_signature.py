"""Signed commands: what is taken, what is refused and why, and the key files."""

import os
from pathlib import Path

import pytest
from typer.testing import CliRunner

from bridge.cli import app
from controllers.commands.command_signature import MAX_TEXT, Signer, Verifier, read_key, write_key
from models.errors import CommandError, ConfigError

KEY = bytes(range(32))
SECOND = 1_000_000_000
WINDOW = 2.0


class Clock:
    """Wall clocks of a sender and of the robot, which begin together."""

    def __init__(self) -> None:
        self.now = 1_790_000_000 * SECOND

    def __call__(self) -> int:
        return self.now

    def advance(self, seconds: float) -> None:
        self.now += round(seconds * SECOND)


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def signer(clock: Clock) -> Signer:
    return Signer(KEY, "teleop", clock)


@pytest.fixture
def verifier(clock: Clock) -> Verifier:
    verifier = Verifier(KEY, WINDOW, clock)
    clock.advance(2.0 * WINDOW)
    return verifier


def test_a_signed_command_is_opened(signer: Signer, verifier: Verifier) -> None:
    for text in ("wave", "turn  left ", "grüße 1.0"):
        command = verifier.verify(signer.sign(text))
        assert (command.source, command.text) == ("teleop", text)


def test_the_line_is_as_documented(signer: Signer, clock: Clock) -> None:
    """The tag is that of openssl dgst -sha256 -mac HMAC over the rest of the line."""
    assert signer.sign("wave") == (
        f"v1 teleop {clock.now} 6c904d0c4d005c1efcd79dba9a962ce24a9659e211471d5269dc10751f351864 wave"
    )


def test_a_command_is_taken_once_however_late_it_is_repeated(signer: Signer, verifier: Verifier, clock: Clock) -> None:
    line = signer.sign("wave")
    verifier.verify(line)
    for wait in (0.0, 1.0, 100.0):
        clock.advance(wait)
        with pytest.raises(CommandError, match=r"replayed: .* newer command, stamped 0\.000 s later$"):
            verifier.verify(line)


def test_an_overtaken_command_is_refused(signer: Signer, verifier: Verifier, clock: Clock) -> None:
    first = signer.sign("walk")
    clock.advance(0.1)
    verifier.verify(signer.sign("stop"))
    with pytest.raises(CommandError, match=r"replayed: .* 0\.100 s later"):
        verifier.verify(first)


def test_sources_are_apart(signer: Signer, verifier: Verifier, clock: Clock) -> None:
    first = signer.sign("walk")
    clock.advance(0.1)
    verifier.verify(Signer(KEY, "safety", clock).sign("stop"))
    assert verifier.verify(first).source == "teleop"


def test_a_command_held_back_is_refused(signer: Signer, verifier: Verifier, clock: Clock) -> None:
    line = signer.sign("walk")
    clock.advance(WINDOW + 0.001)
    with pytest.raises(CommandError, match=r"too old: stamped 2\.001 s ago"):
        verifier.verify(line)


def test_a_command_of_the_future_is_refused_and_does_not_shut_out_later_ones(verifier: Verifier, clock: Clock) -> None:
    ahead = Clock()
    ahead.now = clock.now + 3 * SECOND
    with pytest.raises(CommandError, match=r"stamped 3\.000 s ahead: the clocks"):
        verifier.verify(Signer(KEY, "teleop", ahead).sign("walk"))
    assert verifier.verify(Signer(KEY, "teleop", clock).sign("stop")).text == "stop"


def test_two_commands_of_one_instant_are_both_taken(signer: Signer, verifier: Verifier) -> None:
    assert [verifier.verify(signer.sign(text)).text for text in ("walk", "stop")] == ["walk", "stop"]


def test_a_restarted_sender_goes_on(signer: Signer, verifier: Verifier, clock: Clock) -> None:
    verifier.verify(signer.sign("wave"))
    clock.advance(0.001)
    assert verifier.verify(Signer(KEY, "teleop", clock).sign("stop")).text == "stop"


@pytest.mark.parametrize("skew", [-1.9, 0.0, 1.9])
@pytest.mark.parametrize("down", [0.0, 0.5, 2.5, 10.0])
def test_a_restarted_verifier_takes_no_replay(skew: float, down: float, verifier: Verifier, clock: Clock) -> None:
    other = Clock()
    other.now = clock.now + round(skew * SECOND)
    line = Signer(KEY, "teleop", other).sign("walk")
    verifier.verify(line)
    clock.advance(down)
    again = Verifier(KEY, WINDOW, clock)
    for _ in range(60):
        clock.advance(0.1)
        with pytest.raises(CommandError):
            again.verify(line)


def test_a_verifier_that_has_just_started_says_when_to_try_again(signer: Signer, clock: Clock) -> None:
    verifier = Verifier(KEY, WINDOW, clock)
    clock.advance(0.5)
    with pytest.raises(CommandError, match=r"just started, .*again in 1\.5 s"):
        verifier.verify(signer.sign("walk"))
    clock.advance(1.501)  # the stamp counts: of a sender whose clock is behind it takes longer
    assert verifier.verify(signer.sign("walk")).text == "walk"


def test_clocks_that_jump_are_reported(verifier: Verifier, clock: Clock) -> None:
    """Forward goes on at once; back is refused until it has caught up, and says how long that takes."""
    clock.advance(3600.0)
    verifier.verify(Signer(KEY, "teleop", clock).sign("wave"))
    clock.advance(-3000.0)
    with pytest.raises(CommandError, match="the sender's clock was set back: wait 3000 s"):
        verifier.verify(Signer(KEY, "teleop", clock).sign("wave"))
    clock.advance(-700.0)
    with pytest.raises(CommandError, match=r"the robot's clock was set back, .*again in"):
        verifier.verify(Signer(KEY, "safety", clock).sign("stop"))


@pytest.mark.parametrize("text", ["", "wave", "wave your left hand now", "v walk a b c", "version one two three four"])
def test_an_unsigned_command_is_called_so(text: str, verifier: Verifier) -> None:
    with pytest.raises(CommandError, match="unsigned: sign it"):
        verifier.verify(text)


def test_another_version_is_named(signer: Signer, verifier: Verifier) -> None:
    with pytest.raises(CommandError, match="version 'v2' of the signature is unknown; this is v1"):
        verifier.verify("v2" + signer.sign("wave")[2:])


def test_another_key_is_refused(verifier: Verifier, clock: Clock) -> None:
    with pytest.raises(CommandError, match="forged: the signature of 'teleop' is wrong"):
        verifier.verify(Signer(bytes(32), "teleop", clock).sign("wave"))


def test_a_forgery_changes_nothing(signer: Signer, verifier: Verifier, clock: Clock) -> None:
    """A stamp far ahead under a wrong signature must not make the right ones look old."""
    words = signer.sign("wave").split(" ")
    words[2] = str(clock.now + SECOND)
    with pytest.raises(CommandError, match="forged"):
        verifier.verify(" ".join(words))
    assert verifier.verify(signer.sign("wave")).text == "wave"


@pytest.mark.parametrize("stamp", ["0", "-5", "1e18", "٣", "9" * 20, "1_000", " "])
def test_a_malformed_stamp_is_refused(stamp: str, signer: Signer, verifier: Verifier) -> None:
    words = signer.sign("wave").split(" ")
    words[2] = stamp
    with pytest.raises(CommandError, match="forged"):
        verifier.verify(" ".join(words))


def test_a_long_line_is_not_looked_at(signer: Signer, verifier: Verifier) -> None:
    assert len(verifier.verify(signer.sign("x" * MAX_TEXT)).text) == MAX_TEXT
    with pytest.raises(CommandError, match="1000110 characters are too long"):
        verifier.verify(signer.sign("wave")[:-4] + "x" * 1_000_015)


@pytest.mark.parametrize("text", ["", "  ", "a\nb", "wave\x00", "x" * (MAX_TEXT + 1)])
def test_what_is_no_line_is_not_signed(text: str, signer: Signer) -> None:
    with pytest.raises(CommandError, match="cannot be signed"):
        signer.sign(text)


@pytest.mark.parametrize("source", ["", "two words", "Ä", "teleop\n", "x" * 33])
def test_a_source_is_a_word(source: str) -> None:
    with pytest.raises(ConfigError, match="source"):
        Signer(KEY, source)


@pytest.mark.parametrize("window", [0.0, -1.0, float("nan"), float("inf")])
def test_settings_are_checked(window: float) -> None:
    with pytest.raises(ConfigError, match="window"):
        Verifier(KEY, window)
    for build in (lambda: Verifier(KEY[:31], 1.0), lambda: Signer(KEY[:31], "teleop")):
        with pytest.raises(ConfigError, match="31 bytes are fewer than 32"):
            build()


def test_a_key_file_is_private_random_and_kept(tmp_path: Path) -> None:
    first, second = tmp_path / "a.key", tmp_path / "b.key"
    old = os.umask(0)
    try:
        write_key(first)
    finally:
        os.umask(old)
    write_key(second)
    assert first.stat().st_mode & 0o777 == 0o600
    key = read_key(first)
    assert len(key) == 32 and key != read_key(second)
    with pytest.raises(ConfigError, match="exists already"):
        write_key(first)
    assert read_key(first) == key
    with pytest.raises(ConfigError, match="no key can be written"):
        write_key(tmp_path / "absent" / "a.key")


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o602])
def test_a_key_that_others_can_reach_is_refused_with_the_cure(mode: int, tmp_path: Path) -> None:
    path = tmp_path / "a.key"
    write_key(path)
    path.chmod(mode)
    with pytest.raises(ConfigError, match=f"chmod 600 {path}"):
        read_key(path)
    path.chmod(0o600)
    assert len(read_key(path)) == 32


@pytest.mark.parametrize(("content", "why"), [("ab" * 31, "31 bytes"), ("no key", "hexadecimal"), ("é", "hexadecimal")])
def test_what_is_no_key_is_refused(content: str, why: str, tmp_path: Path) -> None:
    path = tmp_path / "a.key"
    path.write_text(content, encoding="utf-8")
    path.chmod(0o600)
    with pytest.raises(ConfigError, match=why):
        read_key(path)
    with pytest.raises(ConfigError, match="poise key"):
        read_key(tmp_path / "absent")


def test_the_command_line_makes_a_key_and_requires_a_private_one(tmp_path: Path) -> None:
    path = tmp_path / "robot.key"
    made = CliRunner().invoke(app, ["key", str(path)])
    assert made.exit_code == 0 and read_key(path).hex() not in made.output
    assert CliRunner().invoke(app, ["key", str(path)]).exit_code == 2
    path.chmod(0o644)
    sent = CliRunner().invoke(app, ["send", "--key", str(path), "wave"])
    assert sent.exit_code == 2 and "chmod 600" in sent.output.replace("\n", " ")
