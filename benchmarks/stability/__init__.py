"""Survival of disturbances, and quality of standing, walking and estimation."""
