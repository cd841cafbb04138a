"""ROS interface definitions to IDL, C and Python, with the generators of the installed ROS 2."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from models.errors import PoiseError

LIBRARIES = (
    "rosidl_generator_c",
    "rosidl_typesupport_introspection_c",
    "rosidl_typesupport_fastrtps_c",
    "rosidl_typesupport_c",
)
"""Libraries of a package, in the order in which they need each other."""


def generate(package: str, source: Path, files: Sequence[Path], work: Path, share: Path) -> None:
    """Definitions to IDL, to hashes of the types, to C and Python; each generator into a folder of its own.

    Args:
        package: Name of the package.
        source: Folder of its definitions.
        files: The definitions.
        work: Folder to write into.
        share: Where the definitions of other packages are.

    Raises:
        PoiseError: A generator refuses a definition.
    """
    from rosidl_adapter.action import convert_action_to_idl
    from rosidl_adapter.msg import convert_msg_to_idl
    from rosidl_adapter.srv import convert_srv_to_idl
    from rosidl_generator_c.cli import GenerateC
    from rosidl_generator_py.cli import GeneratePython
    from rosidl_generator_type_description.cli import HashTypeDescription
    from rosidl_typesupport_c.cli import GenerateCTypesupport
    from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
    from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

    converters: dict[str, Callable[..., Any]] = {
        ".msg": convert_msg_to_idl,
        ".srv": convert_srv_to_idl,
        ".action": convert_action_to_idl,
    }
    said, idl, include = io.StringIO(), work / "idl" / package, [str(work / "idl"), str(share)]
    try:
        with contextlib.redirect_stdout(said):
            found = []
            for path in files:
                name = path.relative_to(source)
                (idl / name.parent).mkdir(parents=True, exist_ok=True)
                converters[path.suffix](source, package, name, idl / name.parent)
                found.append(f"{idl}:{name.with_suffix('.idl').as_posix()}")
            hashes = HashTypeDescription("hash").generate_type_hashes(
                package, found, include, _folder(work / "hash" / package)
            )
            GenerateC("c").generate(package, found, include, _folder(work / "c" / package), hashes)
            one = ["rosidl_typesupport_c"]
            GeneratePython("py", typesupport_implementations=one).generate(
                package, found, include, _folder(work / "py" / package)
            )
            supports = {
                "rosidl_typesupport_introspection_c": GenerateIntrospectionCTypesupport("introspection_c"),
                "rosidl_typesupport_fastrtps_c": GenerateFastRTPSCTypesupport("fastrtps_c"),
                "rosidl_typesupport_c": GenerateCTypesupport("c", typesupport_implementations=list(LIBRARIES[1:3])),
            }
            for library, support in supports.items():
                support.generate(package, found, include, _folder(work / library / package))
    except Exception as error:  # the generators raise many kinds
        raise PoiseError(f"{package}: the generators refuse it: {type(error).__name__}: {error}") from error


def _folder(path: Path) -> Path:
    path.mkdir(parents=True, exist_ok=True)
    return path
