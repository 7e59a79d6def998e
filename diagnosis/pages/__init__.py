"""What people read: the report's page, its pictures and advice, and the page of the catalogue."""
