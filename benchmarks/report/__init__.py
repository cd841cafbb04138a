"""Suites of benchmarks, their saved reports, and the page of tables and plots."""
