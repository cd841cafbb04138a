"""Supervision and monitors."""
