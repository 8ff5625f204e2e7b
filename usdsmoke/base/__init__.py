"""What every room stands on: errors, settings, records, names, files. No pxr, OpenVDB or torch."""
