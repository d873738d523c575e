"""Accounts and their keys: who may report, read and decide."""
