"""Procedural floor plans: an unlimited number of furnished houses like ProcTHOR's, reproducible by seed."""
