! A surrogate as the material of a finite-element program: an Abaqus UMAT in plane strain.
!
!   surrofe2 export training/bending-bar.h5 --out tissue.c
!   gcc -O3 -march=native -c tissue.c && gfortran -O2 -c umat.f90
!
! Units: um, us, uN; stresses are those in the plane, uN/um, of tissue of unit thickness. STRESS is
! sxx syy szz sxy, with szz = 0. The rate of F is that of a step, (DFGRD1 - DFGRD0)/DTIME, so the
! step is one of backward Euler. DDSDDE belongs to the Jaumann rate of the Kirchhoff stress J sigma,
! over J, and to engineering shear. PROPS(1), if there is one, is the largest bound of the error of
! the stress that is accepted, uN/um. Where there is no stress the step is made shorter, by PNEWDT.

subroutine umat(stress, statev, ddsdde, sse, spd, scd, rpl, ddsddt, drplde, drpldt, stran, dstran, &
    time, dtime, temp, dtemp, predef, dpred, cmname, ndi, nshr, ntens, nstatv, props, nprops, &
    coords, drot, pnewdt, celent, dfgrd0, dfgrd1, noel, npt, layer, kspt, kstep, kinc)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use, intrinsic :: ieee_arithmetic, only: ieee_positive_inf, ieee_value
  implicit none
  integer :: ndi, nshr, ntens, nstatv, nprops, noel, npt, layer, kspt, kstep, kinc
  character(len=80) :: cmname
  real(c_double) :: stress(ntens), statev(nstatv), ddsdde(ntens, ntens), sse, spd, scd, rpl
  real(c_double) :: ddsddt(ntens), drplde(ntens), drpldt, stran(ntens), dstran(ntens), time(2)
  real(c_double) :: dtime, temp, dtemp, predef(1), dpred(1), props(nprops), coords(3), drot(3, 3)
  real(c_double) :: pnewdt, celent, dfgrd0(3, 3), dfgrd1(3, 3)

  interface
    function surrofe2_stress(F, F_rate, tolerance, stress, bound, P_by_F, P_by_F_rate) &
        bind(C, name="surrofe2_stress") result(status)
      import :: c_double, c_int
      real(c_double), intent(in) :: F(4), F_rate(4)
      real(c_double), value :: tolerance
      real(c_double), intent(out) :: stress(4), bound, P_by_F(16), P_by_F_rate(16)
      integer(c_int) :: status
    end function
  end interface

  integer, parameter :: row(3) = [1, 2, 1], column(3) = [1, 2, 2], place(3) = [1, 2, 4]
  real(c_double) :: F(2, 2), rate(4), sigma(4), tau(2, 2), bound, tolerance, J, value
  real(c_double) :: by_F(16), by_rate(16), A(2, 2, 2, 2), slope(2, 2, 2, 2)
  integer :: a1, a2, m, n, i, k

  F = dfgrd1(1:2, 1:2)
  tolerance = ieee_value(tolerance, ieee_positive_inf)
  if (nprops >= 1) tolerance = props(1)
  rate = reshape(transpose(F - dfgrd0(1:2, 1:2)), [4])/dtime
  if (surrofe2_stress(reshape(transpose(F), [4]), rate, tolerance, sigma, bound, by_F, by_rate) &
      /= 0) then
    pnewdt = 0.5_c_double
    return
  end if
  stress = 0.0_c_double
  stress(place) = [sigma(1), sigma(4), 0.5_c_double*(sigma(2) + sigma(3))]

  ! dP(i,j) by dF(k,l) is A(l,k,j,i). With dF = D F and tau = P F', of a symmetric D
  !   d tau(i,m) = F(m,j) A(l,k,j,i) F(n,l) D(k,n) + tau(i,n) D(m,n).
  A = reshape(by_F + by_rate/dtime, [2, 2, 2, 2])
  J = F(1, 1)*F(2, 2) - F(1, 2)*F(2, 1)
  tau = J*transpose(reshape(sigma, [2, 2]))
  do n = 1, 2
    do k = 1, 2
      do m = 1, 2
        do i = 1, 2
          value = dot_product(F(m, :), matmul(F(n, :), A(:, k, :, i)))
          if (k == m) value = value + tau(i, n)
          slope(i, m, k, n) = value/J
        end do
      end do
    end do
  end do
  ddsdde = 0.0_c_double
  do a2 = 1, 3
    do a1 = 1, 3
      i = row(a1); m = column(a1); k = row(a2); n = column(a2)
      ddsdde(place(a1), place(a2)) = 0.25_c_double*(slope(i, m, k, n) + slope(m, i, k, n) &
        + slope(i, m, n, k) + slope(m, i, n, k))
    end do
  end do
end subroutine umat
