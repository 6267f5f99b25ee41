"""Process that runs one camera: driver, engine, spool and upload."""
