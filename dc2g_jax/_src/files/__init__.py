"""Strict readers and atomic writers of images and tables, and the package's resource files."""
