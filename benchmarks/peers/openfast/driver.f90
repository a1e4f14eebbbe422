! Runs the module ExtPtfm under a prescribed motion of the platform: extptfm input.dat motion.txt forces.txt
! motion.txt: the number of instants and their step, then for each the displacements (x, y, z, rx, ry, rz), velocities
! and accelerations. forces.txt: for each the time, forces and moments on the platform, and the modal coordinates.
program driver
   use NWTC_Library
   use ExtPtfm_MCKF
   use ExtPtfm_MCKF_Types
   implicit none
   type(ExtPtfm_InitInputType) :: init
   type(ExtPtfm_InitOutputType) :: told
   type(ExtPtfm_ContinuousStateType) :: x
   type(ExtPtfm_DiscreteStateType) :: xd
   type(ExtPtfm_ConstraintStateType) :: z
   type(ExtPtfm_OtherStateType) :: other
   type(ExtPtfm_MiscVarType) :: misc
   type(ExtPtfm_ParameterType) :: p
   type(ExtPtfm_InputType) :: u(3)
   type(ExtPtfm_OutputType) :: y
   real(DbKi) :: step, times(3)
   real(ReKi), allocatable :: motion(:, :)
   integer(IntKi) :: n, k, count, status
   character(ErrMsgLen) :: message
   character(1024) :: names(3)

   do k = 1, 3
      call get_command_argument(k, names(k))
   end do
   open (11, file=names(2), status='old')
   read (11, *) count, step
   allocate (motion(18, count))
   read (11, *) motion
   close (11)
   init%InputFile = names(1)
   init%RootName = trim(names(3))//'.module'
   call ExtPtfm_Init(init, u(1), p, x, xd, z, other, y, misc, step, told, status, message)
   call check()
   do k = 2, 3
      call ExtPtfm_CopyInput(u(1), u(k), MESH_NEWCOPY, status, message)
      call check()
   end do
   open (12, file=names(3), status='replace')
   do n = 1, count
      call set(u(1), n)
      call ExtPtfm_CalcOutput((n - 1)*step, u(1), p, x, xd, z, other, y, misc, status, message)
      call check()
      write (12, '(*(es24.16))') (n - 1)*step, y%PtfmMesh%Force(:, 1), y%PtfmMesh%Moment(:, 1), x%qm
      if (n == count) exit
      k = max(2, min(count - 1, n))  ! the middle one of three instants, between which inputs are quadratic in time
      call set(u(1), k + 1)
      call set(u(2), k)
      call set(u(3), k - 1)
      times = [k*step, (k - 1)*step, (k - 2)*step]
      call ExtPtfm_UpdateStates((n - 1)*step, n - 1, u, times, p, x, xd, z, other, misc, status, message)
      call check()
   end do
   close (12)

contains

   subroutine set(input, n)
      type(ExtPtfm_InputType), intent(inout) :: input
      integer(IntKi), intent(in) :: n
      real(R8Ki) :: turned(3, 3)
      call SmllRotTrans('platform', motion(4, n), motion(5, n), motion(6, n), turned, '', status, message)
      call check()
      input%PtfmMesh%TranslationDisp(:, 1) = motion(1:3, n)
      input%PtfmMesh%Orientation(:, :, 1) = turned
      input%PtfmMesh%TranslationVel(:, 1) = motion(7:9, n)
      input%PtfmMesh%RotationVel(:, 1) = motion(10:12, n)
      input%PtfmMesh%TranslationAcc(:, 1) = motion(13:15, n)
      input%PtfmMesh%RotationAcc(:, 1) = motion(16:18, n)
   end subroutine set

   subroutine check()
      if (status /= ErrID_None) print '(a)', trim(message)
      if (status >= AbortErrLev) stop 1
   end subroutine check
end program driver
