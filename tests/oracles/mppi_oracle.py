"""One update of IT-MPC in plain NumPy, a copy and a command at a time, in double precision."""

import math

import numpy as np


def improved(controls, noise, state, cost, *, limits, period, temperature, effort):
    """The new controls `[h 2]`, and weight of each copy.

    Args:
      controls: plan so far, `[h 2]`.
      noise: `[k h 2]`.
      state: x, y, yaw, speed and turn rate.
      cost: of x, y and yaw.
      limits: largest speed, turn rate, acceleration and turn acceleration.
      period: seconds of a command.
      temperature: lambda.
      effort: Q, `[2 2]`.
    """
    largest_speed, largest_turn, acceleration, turn_acceleration = limits
    sums, driven = [], np.zeros(noise.shape)
    for k, copy in enumerate(noise):
        x, y, yaw, speed, turn = state
        total = 0.0
        for t, (wished_speed, wished_turn) in enumerate(np.asarray(controls, float) + copy):
            low, high = max(0.0, speed - acceleration * period), min(largest_speed, speed + acceleration * period)
            speed = min(max(wished_speed, low), high)
            low = max(-largest_turn, turn - turn_acceleration * period)
            high = min(largest_turn, turn + turn_acceleration * period)
            turn = min(max(wished_turn, low), high)
            # Along a circle of radius speed / turn around a fixed center.
            if abs(turn) < 1e-9:
                x, y = x + speed * period * math.cos(yaw), y + speed * period * math.sin(yaw)
            else:
                radius, after = speed / turn, yaw + turn * period
                x, y = x + radius * (math.sin(after) - math.sin(yaw)), y - radius * (math.cos(after) - math.cos(yaw))
                yaw = after
            control = np.array([speed, turn])
            total += cost(x, y, yaw) + control @ np.asarray(effort) @ control
            driven[k, t] = control
        sums.append(total)
    beta = min(sums)
    unnormalized = [math.exp(-(total - beta) / temperature) for total in sums]
    weights = np.array(unnormalized) / sum(unnormalized)
    new = np.array(controls, float)
    for weight, commands in zip(weights, driven, strict=True):
        new += weight * (commands - controls)
    return new, weights
