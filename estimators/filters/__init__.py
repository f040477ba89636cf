"""Target filters: measurement and motion models, an interacting multiple model filter and an EKF."""
