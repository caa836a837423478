"""The implementation. What `dc2g_jax` and its modules name is public; nothing here is."""
