"""The cloud's half of the evidence law as pure functions: folding contributions, positions, candidates."""
