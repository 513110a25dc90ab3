"""Blind tests: effects are hidden by one program, found by another that cannot see them, and scored by a third."""
