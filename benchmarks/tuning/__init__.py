"""Search of parameters: `poise tune`."""
