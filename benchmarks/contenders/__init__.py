"""Contenders other than poise: policies loaded from files."""
