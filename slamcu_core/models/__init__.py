"""slamcu models."""
