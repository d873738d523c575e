"""The database: its tables, its schema, the engine, and the private cluster."""
