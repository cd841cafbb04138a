"""Types of packages that may not be built; features that need them are disabled with a message."""

import importlib
from typing import Any

from models.errors import MessageError

ADVICE = "build them with: python -m models.nodes.interface_build"


def interface(package: str, kind: str, name: str) -> Any:
    """Type of a package (``msg``, ``srv`` or ``action``); ``MessageError`` if not built for this Python."""
    try:
        found = getattr(importlib.import_module(f"{package}.{kind}"), name)
        found.__class__.__import_type_support__()
    except Exception as error:  # ImportError, AttributeError, OSError of a library, rclpy's UnsupportedTypeSupport
        raise MessageError(f"no {package}/{kind}/{name}: {ADVICE} ({type(error).__name__}: {error})") from error
    return found


def missing_types() -> str:
    """Reason why the actions of this project are not available; empty if they are."""
    try:
        interface("poise_interfaces", "action", "WalkTo")
    except MessageError as error:
        return str(error)
    return ""
