"""Segmentation thresholds fitted by optimistix against supersampled references."""
