"""The policies under which changes were decided."""
