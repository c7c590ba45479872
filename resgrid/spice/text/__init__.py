"""Text in bulk: columns of names and numbers put together in one array of bytes."""
