"""Aids of the navigator, one file a type: every `AidModel` in a module of this package can be declared by its `kind`.

Lives here: `AID_MODELS`, `aid_settings`, `DEFAULT_AIDS`.
Does not live here: what all aids have in common (aiding.py), which are declared (config.py).
"""

from __future__ import annotations

import importlib
import pkgutil
from typing import Any

from ..aiding import AidModel, AidSettings, models_of

_MODULES = {found.name: importlib.import_module(f"{__name__}.{found.name}") for found in pkgutil.iter_modules(__path__)}

AID_MODELS: dict[str, type[AidModel[Any]]] = models_of(_MODULES)
"""Models by kind, in the order of their files' names."""
DEFAULT_AIDS = {"gps": "gnss_position", "bds": "gnss_position", "doppler": "body_velocity"}
"""The aids of a navigator that is told of no others, and types that need not be written."""


def aid_settings() -> dict[str, type[AidSettings]]:
    """Settings classes by kind."""
    return {kind: model.Settings for kind, model in AID_MODELS.items()}


def make(name: str, settings: AidSettings) -> AidModel[Any]:
    """Model of a declared aid."""
    return AID_MODELS[settings.type](name, settings)
