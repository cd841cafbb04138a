"""The rows of ``poise bench graph_faults``: what is done to the running graph, and what the robot must do."""

from __future__ import annotations

from functools import cache
from typing import Literal

from pydantic.dataclasses import dataclass as schema

from benchmarks.fault_rows import AnyRow, Positive
from models.config import STRICT, default_config

Kind = Literal["plain", "wrapped", "split", "shuffled", "signed", "full_disk", "wall_clock"]
"""Graphs that rows are done to; see ``benchmarks/nodes/graph_kinds.py``."""


@schema(frozen=True, slots=True, kw_only=True, config=STRICT)
class GraphRow(AnyRow):
    """One fault of the graph; acts are of ``benchmarks/nodes/graph_acts.py``.

    Attributes:
        expect: 'rides': same mode, drivers active all the time; 'stands': so, but at rest in mode stand, or ``mode``;
            'damps': mode damp or drivers damped, nothing active afterwards, and arming refused with the ``reason``.
        graph: Which graph it is done to; see ``benchmarks/nodes/graph_kinds.py``.
        restarted: Module of the process that must have been started again, it alone; empty for none.
        said: What the launcher must have said.
        silence: Longest time without a command before the drivers damped for want of one, by their own clock [s].
    """

    expect: Literal["rides", "stands", "damps"]
    graph: Kind = "plain"
    restarted: str = ""
    said: str = ""
    silence: Positive | None = None


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
