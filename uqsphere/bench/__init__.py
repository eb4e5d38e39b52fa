"""Evidence: how fast the models are against their error, and how right they are in hard cases."""
