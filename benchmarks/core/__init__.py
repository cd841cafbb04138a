"""What every benchmark is built from: cases, sweeps, executors, results, figures of time."""
