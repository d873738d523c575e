"""Liars, lost cars and floods against a real server, with honest cars whose errors are those of real passes."""
