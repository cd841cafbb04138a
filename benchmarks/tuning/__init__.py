"""Search for parameters: `poise tune`."""
