"""The search for a front door as an environment to learn in: `functional` for JAX, `gymnasium_env` for Gymnasium."""
