"""Commands of ``poise``."""
