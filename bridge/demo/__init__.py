"""``poise demo``: its course, its measures and its report."""
