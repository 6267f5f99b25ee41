"""`capture-app doctor`: what would keep this machine from leading a rig or joining one."""

from capture_app.commands.doctor.command import doctor as doctor
