"""Commands: arbitration, signatures, obstacle stop."""
