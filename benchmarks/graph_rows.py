"""The rows of ``poise bench graph_faults``: what is done to the running graph, and what the robot must do."""

from __future__ import annotations

from functools import cache
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from models.config import STRICT, default_config

Positive = Annotated[float, Field(gt=0.0)]


@schema(frozen=True, slots=True, config=STRICT)
class GraphRow:
    """One fault.

    Attributes:
        group: Heading in the table.
        act: Name of what is done, of ``benchmarks/nodes/graph_acts.py``.
        expect: 'rides': same mode, drivers active all the time; 'stands': so, but at rest in mode stand; 'damps': mode
            damp or drivers damped, nothing active afterwards, and arming refused.
        within: Time for it, for 'damps' and 'stands' [s].
        reason: Word that the supervisor's diagnostics must hold, for 'damps' the refusal.
        walk: Whether the robot walks.
        duration: Watched from the fault on [s]; None for the usual time.
        mode: In which it stands; empty for stand.
        restarted: Module of the process that must have been started again, it alone; empty for none.
    """

    group: str
    act: str
    expect: Literal["rides", "stands", "damps"]
    within: Positive | None = None
    reason: str = ""
    walk: bool = False
    duration: Positive | None = None
    mode: str = ""
    restarted: str = ""


@schema(frozen=True, slots=True, config=STRICT)
class GraphFaultsConfig:
    """All rows; the unit of every value stands in ``benchmarks/config/graph_faults.yaml``."""

    settle: Positive
    duration: Positive
    forward: Positive
    still: Positive
    rows: dict[str, GraphRow]


@cache
def config() -> GraphFaultsConfig:
    """The packaged rows."""
    return default_config(GraphFaultsConfig, "benchmarks", "graph_faults")
