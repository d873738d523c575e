"""Un-learning: evidence that is taken out again, as if it had never been reported."""
