"""Documentation: pages, and the code that makes them (`docs.build`)."""
