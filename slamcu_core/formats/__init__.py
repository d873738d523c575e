"""slamcu formats."""
