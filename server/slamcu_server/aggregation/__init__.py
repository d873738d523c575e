"""The worker: from acknowledged messages to standing evidence, one transaction per batch."""
