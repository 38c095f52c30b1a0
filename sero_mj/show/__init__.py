"""Geoms to pixels."""
