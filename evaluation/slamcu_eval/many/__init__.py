"""What many cars add: fleets of growing size over changed roads, through the real client to the real server."""
