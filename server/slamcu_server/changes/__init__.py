"""What the service says about the map: changes, their feed, the evidence behind them, and their review."""
