"""The demonstration: a fleet on the paper's road, its cloud, and a map provider who accepts a change."""
