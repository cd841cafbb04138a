"""Whole-body QP of one tick: tasks, limits, problem."""
