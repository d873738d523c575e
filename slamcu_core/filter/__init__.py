"""slamcu filter."""
