"""The law of standing and walking."""
