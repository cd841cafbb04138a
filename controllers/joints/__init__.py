"""Joint drives: servo, torque limits."""
