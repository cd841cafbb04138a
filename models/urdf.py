"""Locate and read a URDF for Pinocchio and MuJoCo; errors name file, joint or link, and cause."""

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import numpy as np
import pinocchio as pin

from models.errors import RobotModelError
from models.types import Matrix

DATA_PACKAGE = "example-robot-data"  #: Distribution with URDFs and meshes of the packaged robots
_DATA_SHARE = Path("share") / "example-robot-data"
_PACKAGE = "package://"


def data_folder() -> Path:
    """Folder of ``package://example-robot-data/``; ``RobotModelError`` when the package is not installed."""
    candidates: list[Path] = []
    with suppress(PackageNotFoundError):
        candidates.append(Path(str(distribution(DATA_PACKAGE).locate_file("cmeel.prefix"))) / _DATA_SHARE)
    # A system installation has it under the prefix of Pinocchio: <prefix>/lib/pythonX/site-packages.
    candidates += [parent / _DATA_SHARE for parent in Path(pin.__file__).resolve().parents]
    for folder in candidates:
        if (folder / "robots").is_dir():
            return folder
    raise RobotModelError(f"the robot descriptions are not installed: add the package '{DATA_PACKAGE}'")


def resolve_uri(uri: str, relative_to: Path, packages: Sequence[Path] = ()) -> Path:
    """Path of a file reference; the file need not exist.

    ``package://PACKAGE/PATH`` outside the packaged data is searched in ``packages`` (packages, or folders of packages),
    then in ``relative_to``, the folder of the file with the reference, and in its parent folders. ``file://PATH``,
    absolute paths and paths relative to ``relative_to`` are also accepted.
    """
    if uri.startswith("file://"):
        return Path(uri[len("file://") :])
    if not uri.startswith(_PACKAGE):
        return relative_to / Path(uri).expanduser()
    package, _, rest = uri[len(_PACKAGE) :].lstrip("/").partition("/")  # some files have a third slash
    if package == DATA_PACKAGE:
        return data_folder() / rest
    for parent in (*packages, relative_to, *relative_to.parents):
        if parent.name == package or (parent / package).is_dir():
            return (parent if parent.name == package else parent / package) / rest
    return relative_to / package / rest


def read_urdf(path: Path) -> ET.Element:
    """Read the ``<robot>`` element of a URDF; refuses files that Pinocchio or MuJoCo would misread or crash on.

    Raises ``RobotModelError``, which names file, joint or link, and cause: unreadable file, invalid XML, no links, a
    joint without usable limits, neither revolute nor fixed, or to a missing link, several roots, or a negative mass.
    """
    root = parse_description(path)
    if root.tag == "mujoco":
        hint = "`poise check-robot` reads MJCF and writes a URDF"
        raise RobotModelError(f"{path}: the root element is <mujoco>, not <robot>; {hint}")
    check_urdf(root, path)
    return root


def parse_description(path: Path) -> ET.Element:
    """Read the root element of a URDF or MJCF file; ``RobotModelError`` names the file and the cause."""
    try:
        root = ET.parse(path).getroot()
    except OSError as error:
        raise RobotModelError(f"{path}: cannot be read: {error.strerror}") from error
    except ET.ParseError as error:
        raise RobotModelError(f"{path}: not valid XML: {error}") from error
    if root.tag not in ("robot", "mujoco"):
        raise RobotModelError(f"{path}: the root element is <{root.tag}>, not <robot>")
    return root


def check_urdf(root: ET.Element, path: Path) -> None:
    """Validate a ``<robot>`` element, as ``read_urdf`` does; ``path`` names it in errors."""
    links = [_name(link, path) for link in root.findall("link")]
    joints = root.findall("joint")
    _refuse_duplicates(links, "link", path)
    _refuse_duplicates([_name(joint, path) for joint in joints], "joint", path)
    children = {_check_joint(joint, set(links), path) for joint in joints}
    if len(children) != len(joints):
        raise RobotModelError(f"{path}: a link is the child of two joints")
    roots = [link for link in links if link not in children]
    if len(roots) != 1:
        raise RobotModelError(f"{path}: expected one root link, found {roots or 'none'}")
    for link in root.findall("link"):
        _check_inertial(link, path)


def _name(element: ET.Element, path: Path) -> str:
    name = element.get("name")
    if not name:
        raise RobotModelError(f"{path}: a <{element.tag}> has no name")
    return name


def _refuse_duplicates(names: list[str], kind: str, path: Path) -> None:
    for name in names:
        if names.count(name) > 1:
            raise RobotModelError(f"{path}: {kind} '{name}' is defined twice")


def _check_joint(joint: ET.Element, links: set[str], path: Path) -> str:
    where = f"{path}: joint '{joint.get('name')}'"
    for role in ("parent", "child"):
        end = joint.find(role)
        link = end.get("link") if end is not None else None
        if link is None:
            raise RobotModelError(f"{where}: has no {role} link")
        if link not in links:
            raise RobotModelError(f"{where}: {role} link '{link}' does not exist")
    kind = joint.get("type")
    if kind == "floating":
        raise RobotModelError(f"{where}: is 'floating'; remove it, the loader adds the floating base itself")
    if kind not in ("revolute", "fixed"):
        raise RobotModelError(f"{where}: type '{kind}' is not supported (revolute and fixed are)")
    if kind == "revolute" and joint.find("mimic") is not None:
        raise RobotModelError(f"{where}: mimic joints are not supported; make it fixed")
    if kind == "revolute":
        limit = joint.find("limit")
        if limit is None:
            raise RobotModelError(f"{where}: has no <limit>")
        keys = ("lower", "upper", "effort", "velocity")
        values = {key: _number(limit.get(key), f"{where}: limit {key}") for key in keys}
        if not values["lower"] < values["upper"]:
            raise RobotModelError(f"{where}: lower limit {values['lower']} is not below upper limit {values['upper']}")
        for key in ("effort", "velocity"):
            if values[key] <= 0.0:
                raise RobotModelError(f"{where}: limit {key} {values[key]} is not positive")
    child = joint.find("child")
    return str(child.get("link")) if child is not None else ""


def _check_inertial(link: ET.Element, path: Path) -> None:
    inertial = link.find("inertial")
    if inertial is None:
        return
    where = f"{path}: link '{link.get('name')}'"
    mass = inertial.find("mass")
    if mass is None or inertial.find("inertia") is None:
        raise RobotModelError(f"{where}: <inertial> needs <mass> and <inertia>")
    if _number(mass.get("value"), f"{where}: mass") < 0.0:
        raise RobotModelError(f"{where}: mass {mass.get('value')} is negative")


def _number(text: str | None, where: str) -> float:
    try:
        value = float(text) if text is not None else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise RobotModelError(f"{where} is {'missing' if text is None else repr(text)}; expected a finite number")
    return value


def for_mujoco(path: Path, *, visuals: bool) -> ET.Element:
    """URDF for MuJoCo's reader, with a ``<mujoco>`` block: inertias unchanged, links unfused, no collision shapes.

    With ``visuals``, visual shapes with meshes that MuJoCo can read (STL, OBJ) are kept, with absolute paths. If a link
    has none, its readable collision shapes are used instead; if it has none either, the link has no shape.
    """
    robot = ET.Element("robot", {"name": path.stem})
    options = {"strippath": "false", "discardvisual": "false" if visuals else "true", "fusestatic": "false"}
    options |= {"balanceinertia": "false", "boundmass": "0", "boundinertia": "0"}
    ET.SubElement(ET.SubElement(robot, "mujoco"), "compiler", options)
    for element in read_urdf(path):
        if element.tag == "link":
            robot.append(_link_for_mujoco(element, path.parent, visuals))
        elif element.tag == "joint" or (element.tag == "material" and visuals):
            robot.append(element)
    return robot


def _link_for_mujoco(link: ET.Element, folder: Path, visuals: bool) -> ET.Element:
    result = ET.Element("link", dict(link.attrib))
    result.extend(link.findall("inertial"))
    if visuals:
        result.extend(shapes_of(link, folder, ("visual", "collision"), (".stl", ".obj")))
    return result


def shapes_of(link: ET.Element, folder: Path, kinds: Sequence[str], formats: Sequence[str] = ()) -> list[ET.Element]:
    """Shapes of a link, as visual elements: the usable shapes of the first kind in ``kinds`` that has any.

    A mesh is usable if its file exists and its suffix is in ``formats``, if not empty. Mesh paths become absolute.
    """
    for kind in kinds:
        shapes = [shape for shape in link.findall(kind) if _usable(shape, folder, formats)]
        for shape in shapes:
            shape.tag = "visual"
        if shapes:
            return shapes
    return []


def _usable(shape: ET.Element, folder: Path, formats: Sequence[str]) -> bool:
    mesh = shape.find("geometry/mesh")
    if mesh is None:
        return shape.find("geometry") is not None
    file = resolve_uri(mesh.get("filename", ""), folder)
    mesh.set("filename", str(file))
    return file.is_file() and (not formats or file.suffix.lower() in formats)


def pinocchio_from_urdf(urdf: Path) -> pin.Model:
    """Check a URDF and build its Pinocchio model with a free-flying base; ``RobotModelError`` names the cause."""
    read_urdf(urdf)
    return _checked(lambda: pin.buildModelFromUrdf(str(urdf), pin.JointModelFreeFlyer()), urdf)


def pinocchio_from_element(robot: ET.Element, urdf: Path, *, bodies: bool = True) -> pin.Model:
    """Like ``pinocchio_from_urdf`` for an element; ``urdf`` names it in errors, ``bodies`` enables inertia checks."""
    check_urdf(robot, urdf)
    text = ET.tostring(robot, encoding="unicode")
    return _checked(lambda: pin.buildModelFromXML(text, pin.JointModelFreeFlyer()), urdf, bodies=bodies)


def possible(inertia: Matrix) -> bool:
    """Whether an inertia (3, 3) about the centre of mass [kg.m^2] is physically possible for a body with mass."""
    low, middle, high = np.linalg.eigvalsh(inertia)
    return bool(low > 0.0 and low + middle >= high * (1.0 - 1e-6))  # 1e-6: rounding of printed inertias


def _checked(build: Callable[[], pin.Model], urdf: Path, *, bodies: bool = True) -> pin.Model:
    try:
        model = build()
    except Exception as error:  # Pinocchio raises several types without a common base
        raise RobotModelError(f"{urdf}: Pinocchio refuses it: {error}") from error
    if bodies:
        _check_bodies(model, urdf)
    return model


def _check_bodies(model: pin.Model, urdf: Path) -> None:
    for joint, inertia in zip(list(model.names)[1:], list(model.inertias)[1:], strict=True):
        where = f"{urdf}: the body moved by joint '{joint}'" if joint != "root_joint" else f"{urdf}: the base"
        if inertia.mass <= 0.0:
            raise RobotModelError(f"{where} has no mass")
        if not possible(inertia.inertia):
            low, middle, high = np.linalg.eigvalsh(inertia.inertia)
            moments = f"{low:.3g}, {middle:.3g}, {high:.3g} kg.m^2"
            raise RobotModelError(f"{where} has an impossible inertia: principal moments {moments}")
