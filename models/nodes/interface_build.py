"""Builds the ROS interfaces in ``models/interfaces`` with the generators of the installed ROS 2 and a C++ compiler.

    python -m models.nodes.interface_build [PREFIX]

The wheels of ROS 2 contain generators, headers and libraries, but neither CMake rules nor colcon. This module performs
their steps: definitions to IDL, IDL to C and Python, C to libraries. An importable package from elsewhere, such as one
built by colcon, is not rebuilt. Without a compiler the graph works without these types; a message names the tool.
"""

import contextlib
import hashlib
import importlib.util
import io
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from models.errors import PoiseError

DEFINITIONS = Path(__file__).resolve().parents[1] / "interfaces"  #: Folder with one subfolder per package
#: Packages to build, and the packages that their definitions refer to, in addition to ``ALWAYS``
PACKAGES = {
    "poise_interfaces": ("geometry_msgs", "trajectory_msgs"),
    "control_msgs": ("trajectory_msgs", "geometry_msgs"),
    "tf2_msgs": ("geometry_msgs",),
    "grid_map_msgs": ("geometry_msgs",),
    "example_interfaces": (),
    "unitree_hg": (),
    "unitree_api": (),
    "booster_interface": (),
    "booster_msgs": (),
    "controller_manager_msgs": (),
    "linear_feedback_controller_msgs": ("geometry_msgs", "sensor_msgs"),
}
#: Packages that every service or action refers to
ALWAYS = ("action_msgs", "service_msgs", "unique_identifier_msgs", "builtin_interfaces", "std_msgs")
STAMP = ".poise_built"  #: File in a built package with the hash of its definitions
#: Packages whose versions the build depends on
VERSIONS = ("rosidl_generator_py", "rosidl_typesupport_fastrtps_c", "rclpy", "numpy")
OUTPUT_MAX = 600  #: Number of final characters of the compiler's output in an error
#: Libraries of a package, in the order of their dependencies
LIBRARIES = (
    "rosidl_generator_c",
    "rosidl_typesupport_introspection_c",
    "rosidl_typesupport_fastrtps_c",
    "rosidl_typesupport_c",
)
ADVICE = "Debian and Ubuntu: sudo apt install g++ python3-dev"

LOADER = '''"""Built by poise from its interface definitions."""

import ctypes
import pathlib

for _name in {libraries}:  # the type support finds the others by name among those that are loaded
    ctypes.CDLL(str(pathlib.Path(__file__).parent / "lib" / f"lib{package}__{{_name}}.so"), mode=ctypes.RTLD_GLOBAL)
'''


class InterfaceBuild:
    """Builds one package into ``into``, a folder on Python's path; ``ros2 interface`` searches ``share``."""

    def __init__(self, package: str, into: Path, share: Path) -> None:
        self._package, self._into, self._share = package, into, share
        self._source = DEFINITIONS / package
        self._files = sorted(path for path in self._source.rglob("*") if path.suffix in (".msg", ".srv", ".action"))
        self._depends = (*ALWAYS, *PACKAGES[package])

    @property
    def stamp(self) -> str:
        """Hash of the definitions, interpreter, ROS 2 and build steps."""
        parts = [sysconfig.get_config_var("EXT_SUFFIX"), *(ros_version(name) for name in VERSIONS)]
        digest = hashlib.sha256("".join(parts).encode() + Path(__file__).read_bytes())
        for path in self._files:
            digest.update(path.relative_to(self._source).as_posix().encode() + path.read_bytes())
        return digest.hexdigest()

    def run(self) -> None:
        """Generate, compile and install the package; ``PoiseError`` names a missing tool or quotes a failed one."""
        require_tools()
        self._prefix = ros_prefix()
        with tempfile.TemporaryDirectory(prefix="poise_interfaces_") as folder:
            work = Path(folder)
            with ament_prefix(self._prefix):
                generate(self._package, self._source, self._files, work, self._prefix / "share")
            made = work / "made"
            shutil.copytree(work / "py" / self._package, made)
            self._build_libraries(work, made)
            (made / "__init__.py").write_text(LOADER.format(libraries=LIBRARIES, package=self._package))
            (made / STAMP).write_text(self.stamp)
            install(made, self._into / self._package)
        self._register()

    def _build_libraries(self, work: Path, made: Path) -> None:
        import numpy as np

        folder = made / "lib"
        folder.mkdir()
        include = [self._prefix / "include", *(self._prefix / "include").iterdir()]
        include += [work / name for name in ("c", "py", *LIBRARIES[1:])]
        include += [Path(sysconfig.get_paths()["include"]), Path(np.get_include())]
        common = ["-shared", "-fPIC", "-O1", "-w", *(f"-I{path}" for path in include if path.is_dir())]
        common += [f"-L{self._prefix / 'lib'}", f"-L{folder}"]
        needs: dict[str, list[str]] = {
            "rosidl_generator_c": ["rosidl_runtime_c", "rcutils"],
            "rosidl_typesupport_introspection_c": ["rosidl_typesupport_introspection_c", "rosidl_runtime_c"],
            "rosidl_typesupport_fastrtps_c": [
                "fastcdr",
                "rosidl_typesupport_fastrtps_c",
                "rosidl_typesupport_fastrtps_cpp",
                "rosidl_runtime_c",
                "rmw",
            ],
            "rosidl_typesupport_c": ["rosidl_typesupport_c", "rosidl_runtime_c"],
        }
        for name in LIBRARIES:
            sources = _sources(work / ("c" if name == "rosidl_generator_c" else name))
            kinds = dict.fromkeys(("rosidl_generator_c", name))  # for init and fini of sequences of their messages
            own = [] if name == "rosidl_generator_c" else [f"{self._package}__rosidl_generator_c"]
            links = [*own, *needs[name], *(f"{package}__{kind}" for package in self._depends for kind in kinds)]
            file = f"lib{self._package}__{name}.so"
            options = [f"-Wl,-soname,{file}", "-Wl,-z,defs", "-Wl,-rpath,$ORIGIN"]
            _compile([*common, "-o", str(folder / file), *sources, *(f"-l{link}" for link in links), *options])
        links = [f"{self._package}__{name}" for name in ("rosidl_generator_c", "rosidl_typesupport_c")]
        links += ["rosidl_runtime_c", *(f"{package}__rosidl_generator_py" for package in self._depends)]
        file = f"{self._package}_s__rosidl_typesupport_c{sysconfig.get_config_var('EXT_SUFFIX')}"
        sources = _sources(work / "py")
        _compile(
            [*common, "-o", str(made / file), *sources, *(f"-l{link}" for link in links), "-Wl,-rpath,$ORIGIN/lib"]
        )

    def _register(self) -> None:
        """Install the files for ``ros2 interface``: the definitions, and their names in the index."""
        names = [path.relative_to(self._source).as_posix() for path in self._files]
        for path, name in zip(self._files, names, strict=True):
            there = self._share / self._package / name
            there.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, there)
        index = self._share / "ament_index/resource_index"
        for kind, text in (("packages", ""), ("rosidl_interfaces", "\n".join(names))):
            (index / kind).mkdir(parents=True, exist_ok=True)
            (index / kind / self._package).write_text(text)


def install(made: Path, place: Path) -> None:
    """Copy a folder beside ``place``, then rename it; the old folder is deleted last. Never leaves a partial folder."""
    new, old = (place.with_name(f".{place.name}.{name}") for name in ("new", "old"))
    for each in (new, old):
        shutil.rmtree(each, ignore_errors=True)
    shutil.copytree(made, new)
    if place.exists():
        place.rename(old)
    new.rename(place)
    shutil.rmtree(old, ignore_errors=True)


def ros_prefix() -> Path:
    """Prefix of the ROS 2 installation of this interpreter; ``PoiseError`` if it has no generators."""
    spec = importlib.util.find_spec("rosidl_generator_py")
    if spec is None or spec.origin is None:
        raise PoiseError("the generators of ROS 2 interfaces are not installed (rosidl_generator_py)")
    for parent in Path(spec.origin).parents:
        if (parent / "share/rosidl_generator_py").is_dir() and (parent / "include").is_dir():
            return parent
    raise PoiseError(f"no headers of ROS 2 beside {spec.origin}")


@contextlib.contextmanager
def ament_prefix(prefix: Path) -> Iterator[None]:
    """Set the generators' template path, unless a sourced ROS 2 has set it."""
    before = os.environ.get("AMENT_PREFIX_PATH")
    os.environ["AMENT_PREFIX_PATH"] = before or str(prefix)
    try:
        yield
    finally:
        if not before:
            del os.environ["AMENT_PREFIX_PATH"]


def ros_version(name: str) -> str:
    """Version of a ROS 2 package; empty when unknown."""
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def require_tools() -> None:
    """Check for a compiler and Python's headers; ``PoiseError`` contains the command that installs them."""
    missing = [name for name in ("gcc", "g++") if shutil.which(name) is None]
    if not (Path(sysconfig.get_paths()["include"]) / "Python.h").is_file():
        missing.append("Python.h")
    if missing:
        raise PoiseError(f"{', '.join(missing)} not found; {ADVICE}")


def build_interfaces(into: Path, report: Callable[[str], object] = print, share: Path | None = None) -> bool:
    """Build missing and outdated packages into a folder on Python's path; False if one is skipped.

    ``ros2 interface`` searches ``share``, that of this environment when None; ``report`` gets one line per package.
    """
    complete = True
    for package in PACKAGES:
        spec, built = importlib.util.find_spec(package), into / package / STAMP
        if spec is not None and spec.origin is not None and Path(spec.origin).parent != built.parent:
            report(f"{package}: the package of the installed ROS 2 is used")
            continue
        try:
            build = InterfaceBuild(package, into, share or Path(sys.prefix) / "share")
            if not built.is_file() or built.read_text() != build.stamp:
                build.run()
                report(f"{package}: built")
        except (PoiseError, OSError) as error:
            complete = False
            report(f"{package} is left out with its services and actions; everything else works: {error}")
    return complete


def _sources(folder: Path) -> list[str]:
    return sorted(str(path) for kind in ("*.c", "*.cpp") for path in folder.rglob(kind))


def _compile(arguments: list[str]) -> None:
    compiler = ["g++", "-std=c++17"] if any(item.endswith(".cpp") for item in arguments) else ["gcc"]
    result = subprocess.run([*compiler, *arguments], capture_output=True, text=True, check=False)
    if result.returncode:
        raise PoiseError(f"the compiler failed: {result.stderr[-OUTPUT_MAX:].strip()}")


def main() -> None:
    """Build into this environment or into a given prefix, such as a colcon workspace."""
    prefix = sys.argv[1] if len(sys.argv) > 1 else sys.prefix
    into = Path(sysconfig.get_path("purelib", vars={"base": prefix}))
    build_interfaces(into, lambda text: print(f"poise: {text}"), Path(prefix) / "share")


def generate(package: str, source: Path, files: Sequence[Path], work: Path, share: Path) -> None:
    """Generate IDL, type hashes, C and Python in ``work``; ``share`` contains the definitions of other packages."""
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
    output, idl, include = io.StringIO(), work / "idl" / package, [str(work / "idl"), str(share)]
    try:
        with contextlib.redirect_stdout(output):
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
    except Exception as error:  # the generators raise many types
        raise PoiseError(f"{package}: the generators failed: {type(error).__name__}: {error}") from error


def _folder(path: Path) -> Path:
    path.mkdir(parents=True, exist_ok=True)
    return path


if __name__ == "__main__":
    main()
