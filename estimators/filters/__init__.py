"""Target filters: motion and measurement models, an EKF, a UKF and an interacting multiple model filter."""
