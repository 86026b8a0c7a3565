"""What people see of missions: lines on the console, results in files, pictures."""
