"""Bytes to values: the packet language and the sources that speak it."""
