"""What several experiments share: drives, searches, and the results that the authors published."""
