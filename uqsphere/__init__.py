"""Fracture risk and uncertainty quantification for brittle spheres between split Hopkinson bars."""

from __future__ import annotations

__version__ = "0.1.0"
