"""Calibration file of a node's robot: location, and refused files in log and diagnostics."""

from models.calibration import Calibration
from models.calibration_store import CalibrationStore
from models.nodes.base import PoiseNode
from models.nodes.parameters import declare

CALIBRATION_DIR, NO_FILE = "calibration_dir", "none"  #: Parameter, and its value that disables the calibration


def declare_calibration(node: PoiseNode, default: str = "") -> None:
    """Declare the parameter ``calibration_dir``, the folder of the calibration files."""
    text = f"Folder of the calibration files; empty for the usual one, '{NO_FILE}' to read none"
    declare(node, CALIBRATION_DIR, default, text)


class CalibrationFile:
    """Reads the calibration at the start of a node, and reports it.

    The parameter ``calibration_dir`` is the folder: empty for the default of ``models.calibration_store``, ``none`` for
    no calibration. The file is named after the robot and the node's namespace. The node's diagnostics contain
    ``calibration`` and, after a refusal, ``calibration refused``.
    """

    def __init__(self, node: PoiseNode) -> None:
        self._node = node
        self._folder = str(node.get_parameter(CALIBRATION_DIR).value)
        self._logged = ""

    @property
    def store(self) -> CalibrationStore | None:
        """Calibration files; None if disabled. ``ConfigError`` without a usable folder."""
        if self._folder == NO_FILE:
            return None
        return CalibrationStore(self._node.model, self._folder or None, namespace=self._node.get_namespace())

    def read(self) -> Calibration:
        """Newest usable calibration; refused files are reported. ``ConfigError`` without a usable folder."""
        store, node = self.store, self._node
        if store is None:
            node.values["calibration"] = "none is read"
            return Calibration.none(node.model)
        found, refused = store.load()
        node.values["calibration"] = ", ".join(f"{what} of {stamp}" for what, stamp in found.stamps) or "none"
        node.values.pop("calibration refused", None)
        if refused:
            node.values["calibration refused"] = "; ".join(refused)
            node.refuse("calibration file", "; ".join(refused))
        report = f"calibration: {node.values['calibration']} ({store.path})"
        if report != self._logged:
            node.get_logger().info(report)
            self._logged = report
        return found
