"""Balance and walk from a recording, and their plots."""
