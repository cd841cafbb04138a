"""Black box of the control stack."""
