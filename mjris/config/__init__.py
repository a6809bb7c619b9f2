"""Every parameter of a run: its schema and defaults, presets, files, and what is wrong with a value.

Imports nothing of the package: all else takes its numbers from here.
"""

from mjris.config.errors import ConfigError, validated
from mjris.config.fields import Positive
from mjris.config.files import from_dict, load
from mjris.config.link_tables import LINK_TABLES
from mjris.config.materials import BODY_DB, LOOKS, MATERIALS, look_loss_db
from mjris.config.presets import preset
from mjris.config.radio import Hardware, Knowledge, Radio, dbm_to_w, w_to_dbm
from mjris.config.schema import Agent, Config, Federation, Task, World

__all__ = [
    "BODY_DB",
    "LINK_TABLES",
    "LOOKS",
    "MATERIALS",
    "Agent",
    "Config",
    "ConfigError",
    "Federation",
    "Hardware",
    "Knowledge",
    "Positive",
    "Radio",
    "Task",
    "World",
    "dbm_to_w",
    "from_dict",
    "load",
    "look_loss_db",
    "preset",
    "validated",
    "w_to_dbm",
]
