"""Several aircraft on one target: roles, joint decisions and separation."""
