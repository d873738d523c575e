"""Message ingest: what vehicles send, checked and logged once."""
