"""From a depth picture to the numbers that are compared: shape on the cloth's cells, the panel's plane, pixels."""
