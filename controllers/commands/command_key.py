"""Key files of signed commands: random bytes in hexadecimal, readable by their owner alone."""

from __future__ import annotations

import os
import secrets
import stat
from pathlib import Path

from controllers.commands.command_signature import KEY_BYTES
from models.errors import ConfigError

_MAX_SIZE = 4096  #: Longest file that is read [bytes]


def write_key(path: Path) -> None:
    """Create a key file of ``KEY_BYTES`` random bytes with mode 0600.

    Raises:
        ConfigError: The file exists, or cannot be written.
    """
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
    """Read a key file.

    Raises:
        ConfigError: It is absent, readable by others, or not at least ``KEY_BYTES`` bytes in hexadecimal.
    """
    try:
        with path.open("rb") as file:
            mode = os.fstat(file.fileno()).st_mode  # of the very file that is read
            text = file.read(_MAX_SIZE)
    except OSError as error:
        raise ConfigError(f"{path}: no key can be read: {error.strerror}; make one with: poise key {path}") from error
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise ConfigError(f"{path}: others may read or write this key; make it private with: chmod 600 {path}")
    try:
        key = bytes.fromhex(text.decode("ascii").strip())
    except ValueError as error:
        raise ConfigError(f"{path}: not a key in hexadecimal") from error  # without its content
    if len(key) < KEY_BYTES:
        raise ConfigError(f"{path}: {len(key)} bytes are fewer than {KEY_BYTES}")
    return key
