"""Black-box recorder of the control stack."""
