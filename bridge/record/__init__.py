"""Recordings of runs: MCAP files, their contents, and data sets made from them."""
