"""Model terms, reduction and solution of the whole-body quadratic program."""
