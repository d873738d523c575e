"""What the fleet has looked at: a provider need not survey it again."""
