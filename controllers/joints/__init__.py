"""Joint servo, motor drivers and torque limits."""
