"""Trust: what the server makes of the contributors' records, in versions."""
