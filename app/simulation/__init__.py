"""The product in a closed loop without sockets, on a fake clock: decoding, checks, control step and exchange."""
