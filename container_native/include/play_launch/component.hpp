#pragma once

/// Everything a component or a program made of components needs.

#include <play_launch/callback_group.hpp>
#include <play_launch/component_registry.hpp>
#include <play_launch/context.hpp>
#include <play_launch/error.hpp>
#include <play_launch/executor.hpp>
#include <play_launch/logging.hpp>
#include <play_launch/node.hpp>
#include <play_launch/node_options.hpp>
#include <play_launch/parameter.hpp>
#include <play_launch/private_memory.hpp>
#include <play_launch/publisher.hpp>
#include <play_launch/qos.hpp>
#include <play_launch/service.hpp>
#include <play_launch/subscription.hpp>
#include <play_launch/timer.hpp>
