"""The whole-body quadratic program: model terms, reduction, assembly, solution."""
