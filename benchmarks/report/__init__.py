"""Suites of benchmarks, saved reports, and the report page with tables and plots."""
