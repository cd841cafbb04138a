"""Balance law for standing and walking."""
