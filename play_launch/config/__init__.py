"""The configuration file: read it, check it, resolve it into an immutable model."""

from play_launch.config.description import describe
from play_launch.config.load import load_config, parse_config
from play_launch.config.model import (
    ComposableNodeConfig,
    ContainerConfig,
    ContainerType,
    Isolation,
    ParameterConfig,
    ParameterPayload,
    ParameterType,
    ParameterValue,
    ProcessConfig,
    ReplayConfig,
    StopLimits,
)
from play_launch.config.problems import ConfigError, Place, Problem
from play_launch.core.crash import OnCrash
from play_launch.core.restart import RestartLimits

__all__ = [
    "ComposableNodeConfig",
    "ConfigError",
    "ContainerConfig",
    "ContainerType",
    "Isolation",
    "OnCrash",
    "ParameterConfig",
    "ParameterPayload",
    "ParameterType",
    "ParameterValue",
    "Place",
    "Problem",
    "ProcessConfig",
    "ReplayConfig",
    "RestartLimits",
    "StopLimits",
    "describe",
    "load_config",
    "parse_config",
]
