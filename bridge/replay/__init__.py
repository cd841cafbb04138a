"""Replay of recorded runs."""
