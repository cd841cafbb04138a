"""Tasks, limits and assembly of the whole-body QP."""
