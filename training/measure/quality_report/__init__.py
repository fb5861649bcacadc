"""Keeps the tables and pictures of docs/quality.md to what was measured."""
