"""Compiled code, rotations, threads."""
