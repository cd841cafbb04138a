"""Parts of the closed loop in one process."""
