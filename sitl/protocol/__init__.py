"""MAVLink on the side of the vehicle: messages, transfers, parameters, signing and link faults."""
