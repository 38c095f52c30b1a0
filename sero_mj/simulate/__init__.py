"""Torque-controlled robots: what moves them, what they are told to do, and what they feel."""
