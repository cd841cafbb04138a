"""Plants: robots behind one interface, simulated or real."""
