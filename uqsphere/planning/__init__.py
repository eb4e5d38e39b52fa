"""The design of a test: striker speeds, ramps and lengths that break a sphere as wanted."""
