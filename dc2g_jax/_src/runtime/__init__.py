"""What every room needs: errors, compiled programs, devices, progress bars, plug-ins and parts of the user's own."""
