"""The configuration file: read it, check it, resolve it into an immutable model."""

from play_launch.config.description import describe
from play_launch.config.load import load_config, parse_config
from play_launch.config.model import (
    BeforeCrashConfig,
    ComposableNodeConfig,
    ContainerConfig,
    ContainerType,
    Isolation,
    KeepConfig,
    MemoryDomains,
    Output,
    ParameterConfig,
    ParameterPayload,
    ParameterType,
    ParameterValue,
    ProcessConfig,
    RecordConfig,
    ReplayConfig,
    RotateConfig,
    SamplingConfig,
    StopLimits,
)
from play_launch.config.problems import ConfigError, Place, Problem
from play_launch.core.crash import OnCrash
from play_launch.core.restart import OnExit, RestartLimits

__all__ = [
    "BeforeCrashConfig",
    "ComposableNodeConfig",
    "ConfigError",
    "ContainerConfig",
    "ContainerType",
    "Isolation",
    "KeepConfig",
    "MemoryDomains",
    "OnCrash",
    "OnExit",
    "Output",
    "ParameterConfig",
    "ParameterPayload",
    "ParameterType",
    "ParameterValue",
    "Place",
    "Problem",
    "ProcessConfig",
    "RecordConfig",
    "ReplayConfig",
    "RestartLimits",
    "RotateConfig",
    "SamplingConfig",
    "StopLimits",
    "describe",
    "load_config",
    "parse_config",
]
