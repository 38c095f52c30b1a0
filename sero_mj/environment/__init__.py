"""Simulated robots as `dm_env` environments, for reinforcement learning."""
