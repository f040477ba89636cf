"""The shell: command line, configuration, link to the autopilot, the control loop, records and replay."""
