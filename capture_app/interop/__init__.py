"""What other programs of the field speak: phones with libsoftwaresync or RecSync, and rpicam-apps."""
