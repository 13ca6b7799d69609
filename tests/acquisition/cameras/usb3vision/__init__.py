"""A USB3 Vision camera written for the tests, independent of the driver."""
