"""Commands that rows of ``poise bench graph_faults`` give: of two sources, unsigned, replayed, at a bad moment."""

from __future__ import annotations

from collections.abc import Iterator

from std_msgs.msg import String

from benchmarks.nodes.graph_stage import GraphStage, User
from controllers.command_key import read_key
from controllers.command_signature import Signer
from models.nodes import topics
from models.nodes.qos import EVENT
from models.nodes.spin import SPIN_TIMEOUT

WATCH = 3.0
"""For which somebody goes on commanding [s]."""


def two_commanders(stage: GraphStage) -> Iterator[float]:
    """While ``plain`` says to walk, ``teleop`` says to stand still, and ``autonomy`` wants something else."""
    _, velocity = topics.source_topics("teleop")
    teleop = User(stage.graph, velocity)
    teleop.walk(0.0)
    autonomy = stage.graph.node.create_publisher(String, topics.source_topics("autonomy")[0], EVENT)
    yield 1.0
    autonomy.publish(String(data="forward"))
    yield WATCH
    teleop.walk(None)
    stage.graph.node.destroy_publisher(autonomy)


def unsigned(stage: GraphStage) -> Iterator[float]:
    """Words and velocities without a signature."""
    stage.graph.send("wave")
    stage.user.walk(0.3)
    yield 1.0
    stage.user.walk(None)


def replayed(stage: GraphStage) -> Iterator[float]:
    """A signed word that is taken, and then comes again; before, one that somebody has changed."""
    signed = Signer(read_key(stage.made.key), "teleop").sign("walk")
    stage.graph.send(signed.replace("walk", "wave"))
    yield SPIN_TIMEOUT
    stage.graph.send(signed)
    stage.graph.wait_for(lambda: stage.graph.mode == "walk", WATCH, "walking as a signed command says")
    stage.ask("mode/stand")
    stage.graph.wait_for(lambda: stage.graph.mode == "stand", WATCH, "standing again")
    stage.graph.send(signed)
    yield WATCH


def stand_while_walking(stage: GraphStage) -> Iterator[float]:
    """Mode stand, while the user goes on commanding a velocity."""
    stage.ask("mode/stand")
    yield from ()
