"""The exchange with the autopilot: what it reports and what is sent to it, as one deterministic state machine."""
